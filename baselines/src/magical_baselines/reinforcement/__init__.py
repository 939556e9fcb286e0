"""Parts of PPO and the algorithms built on it: rollouts, replay buffer, rewards, monitoring."""
