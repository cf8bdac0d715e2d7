"""Simulated effects, such as a palsy or more weight, beside rules of thumb and the network."""
