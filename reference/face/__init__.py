"""A face as a scene: parameters p, what settles, frames one after another, and how it answers to small changes."""
