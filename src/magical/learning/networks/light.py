"""`small` with a stride of 4 in the first convolution and one layer fewer, for learning online."""

from magical.learning.networks.paper import ConvolutionStack

NETWORK = ConvolutionStack(((32, 5, 4), (64, 3, 2), (64, 3, 2)), (256,))
