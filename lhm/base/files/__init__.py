"""Files that are read and written: surfaces, layered heads, arrays, and the user's cache; whole files or none."""
