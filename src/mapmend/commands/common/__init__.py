"""What commands share: ``options`` (arguments and what they mean), ``console`` (what is printed), ``inputs``."""
