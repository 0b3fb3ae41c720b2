"""Adapters to the libraries that slam_bof works with, each loaded only when named."""
