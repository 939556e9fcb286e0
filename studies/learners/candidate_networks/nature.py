"""The network of Mnih et al., "Human-level control through deep reinforcement learning", 2015."""

from magical_baselines.networks.paper import ConvolutionStack

NETWORK = ConvolutionStack(((32, 8, 4), (64, 4, 2), (64, 3, 1)), (512,))
HIDDEN, make_convolutions = NETWORK.HIDDEN, NETWORK.make_convolutions
