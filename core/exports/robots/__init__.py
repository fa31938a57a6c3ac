"""Formats of robots: ROS 2 messages and TUM trajectories; body axes x forward, y left, z up."""
