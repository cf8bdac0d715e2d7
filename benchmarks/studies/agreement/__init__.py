"""Whether PD's faces agree with finite elements' and with the network's."""
