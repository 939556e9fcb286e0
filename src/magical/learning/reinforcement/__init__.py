"""What PPO and the algorithms built on it share: rollouts, replay buffer, rewards, monitoring."""
