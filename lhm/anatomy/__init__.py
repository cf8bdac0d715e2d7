"""Real anatomy: bones and muscles placed inside a skin, and closed surfaces made of them."""
