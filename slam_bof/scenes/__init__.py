"""Scene labels: models and their training, labellers, smoothing, rooms of a map."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
