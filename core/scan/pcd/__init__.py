"""PCD of the Point Cloud Library: ascii, binary and compressed."""
