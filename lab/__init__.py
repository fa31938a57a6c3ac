"""What measures the method: made-up rooms with exact poses, evaluation, benchmarks, and their commands."""
