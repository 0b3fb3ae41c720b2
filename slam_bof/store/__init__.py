"""The saved map (map.db): write, read, query, check, prune, recover."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
