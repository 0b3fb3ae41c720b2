"""A ROS 2 node around ``slam_bof.LoopCloser``; ``node`` alone needs ROS."""
