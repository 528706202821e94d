"""Figures of the results.

No other part of the package imports matplotlib. The functions here draw numbers and know no
experiment. Each name is imported when it is first used, so that matplotlib is loaded only then.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
