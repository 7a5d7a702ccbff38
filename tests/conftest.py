"""Property tests try the same examples every time, however long a first call compiles: a red run has a reason."""

from hypothesis import settings

settings.register_profile("same_examples", derandomize=True, deadline=None)
settings.load_profile("same_examples")
