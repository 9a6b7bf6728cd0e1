"""Logs: MCAP files with ROS 2 messages, written by a process of their own; reading, replay and plots."""
