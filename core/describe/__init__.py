"""Patches of a view or panorama, and the histograms and short vectors that describe them."""
