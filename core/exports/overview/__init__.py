"""Pictures of a whole placement for people: a plan with the photos in it, and a contact sheet of all photos."""
