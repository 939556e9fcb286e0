"""Trajectories on disk: the trajectory, its file format, the manifest, reading and writing."""
