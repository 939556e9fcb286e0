"""`light` with half the channels in its first two convolutions."""

from magical_baselines.networks.paper import ConvolutionStack

NETWORK = ConvolutionStack(((16, 5, 4), (32, 3, 2), (64, 3, 2)), (256,))
