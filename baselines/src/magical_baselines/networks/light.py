"""Fig. 11 with few channels and a stride of 4 in the first convolution, for learning online."""

from magical_baselines.networks.paper import ConvolutionStack

NETWORK = ConvolutionStack(((32, 5, 4), (64, 3, 2), (64, 3, 2)), (256,))
