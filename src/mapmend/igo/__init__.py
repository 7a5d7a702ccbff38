"""Iterative graph optimization: biased edges are matched again from the optimizer's poses (IGO section IV)."""
