"""Learners of goals and of objects for the MAGICAL benchmark."""
