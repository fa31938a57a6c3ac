"""The method `paper`: CPO (ECCV 2022) with its own parameters."""
