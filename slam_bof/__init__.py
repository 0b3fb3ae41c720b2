"""Depth-only place recognition, loop closing and scene labels for any SLAM front-end."""
