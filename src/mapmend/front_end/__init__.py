"""From a log to a pose graph (IGO section III)."""
