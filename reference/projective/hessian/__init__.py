"""The exact Hessian and Newton's step."""
