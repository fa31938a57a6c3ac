"""What measures the method: procedural rooms with exact poses, evaluation, benchmarks, and their commands."""
