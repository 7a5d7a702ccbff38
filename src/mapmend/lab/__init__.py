"""What only benchmarks and tests use: known errors put into logs, graphs and maps; rivals; figures of experiments."""
