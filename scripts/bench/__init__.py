"""The benchmark of scripts/benchmark.py: a subject a file, each with a TITLE and `measure(run)`, which yields its figures."""
