"""Fig. 11 with about a tenth of the multiply-adds: fewer channels, a stride of 2 from the start."""

from magical.learning.networks.paper import ConvolutionStack

NETWORK = ConvolutionStack(((32, 5, 2), *[(64, 3, 2)] * 3), (256,))
