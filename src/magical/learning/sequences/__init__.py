"""What learners of sequences of actions share: how they are fitted, and chunks of actions."""
