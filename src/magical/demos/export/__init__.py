"""Demonstrations in other formats: Minari, LeRobot, video."""
