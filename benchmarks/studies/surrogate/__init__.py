"""The network on people it has not seen, and the parts of its error."""
