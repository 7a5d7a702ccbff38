"""The particle filter that IGO compares with."""
