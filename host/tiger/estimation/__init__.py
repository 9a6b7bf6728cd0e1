"""State estimation and identification."""
