"""Inferring the goal of demonstrations: a posterior over programs of the goal language."""
