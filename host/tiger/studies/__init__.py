"""Experiments of the dissertation, one file each."""
