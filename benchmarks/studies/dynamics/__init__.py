"""Inertia: masses, shaken heads and cheeks that are let go."""
