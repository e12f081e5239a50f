"""Networks that learn a sensor's images from measured presses; everything here needs torch."""

from dotsim_ros.optics.learning.fitting import FittedNetwork, fit_network
from dotsim_ros.optics.learning.networks import KINDS

__all__ = ["KINDS", "FittedNetwork", "fit_network"]
