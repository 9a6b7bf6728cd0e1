"""TIGER: control stack of a four-wheel robot that rides on elastic actuated mechanisms."""
