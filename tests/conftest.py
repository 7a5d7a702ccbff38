"""Property tests try the same examples every time: a red run is red for everybody, and for a reason."""

from hypothesis import settings

settings.register_profile("same_examples", derandomize=True)
settings.load_profile("same_examples")
