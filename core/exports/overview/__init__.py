"""Pictures of a whole placement for people: the scan from above with its photos, and all photos with what became of them."""
