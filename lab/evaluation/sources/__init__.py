"""Where cases come from: procedural suites, folders, and photos in place of their panoramas."""
