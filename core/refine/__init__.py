"""Refinement: from candidates to poses that align the points they see, by Gauss-Newton steps."""
