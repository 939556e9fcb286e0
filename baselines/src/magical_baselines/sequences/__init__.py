"""Shared parts of the learners of action sequences: fitting, and chunks of actions."""
