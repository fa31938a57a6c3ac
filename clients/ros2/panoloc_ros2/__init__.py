"""Gives a robot its place in a scanned building: `map` to `odom`, from camera images and odometry.

`place_finder` has the order of the steps. Two transports carry its messages: `node` for ROS 2 and `dds` where there is no ROS. Nothing
but numpy is needed beside them.
"""
