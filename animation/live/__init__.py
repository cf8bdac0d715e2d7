"""A head in the browser that answers while sliders move: network at once, then derivatives, then the simulator."""
