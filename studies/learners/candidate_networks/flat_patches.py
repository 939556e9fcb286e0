"""`light` whose first layer takes patches of 4 x 4 pixels that do not overlap."""

from magical_baselines.networks.paper import ConvolutionStack

NETWORK = ConvolutionStack(((32, 4, 4), (64, 3, 2), (64, 3, 2)), (256,))
HIDDEN, make_convolutions = NETWORK.HIDDEN, NETWORK.make_convolutions
