"""What images are compared by: colours without their light, histograms of patches, lines."""
