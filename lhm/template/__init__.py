"""How a skin becomes a head: the template, its wraps, registration, and depths of soft tissue."""
