"""Place recognition among earlier views, and localisation of single frames in a map."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
