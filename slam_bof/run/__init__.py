"""One run of the mini-SLAM over a sequence, and the folder that it leaves."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
