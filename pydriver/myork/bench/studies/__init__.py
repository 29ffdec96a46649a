"""The benchmarks, one module each; `myork.bench` says what they return."""
