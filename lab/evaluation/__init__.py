"""Measuring methods on cases with known poses: procedural suites, case folders, and the paper's data sets.

Sources yield `ScanCases`; `Evaluation` runs methods on them and writes rows; `summaries` makes the paper's tables of rows, and
`fit_confidence` the coefficients of the confidence.
"""
