"""Demonstrations in other formats: Minari, LeRobot and videos."""
