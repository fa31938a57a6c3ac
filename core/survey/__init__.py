"""What surveyors do by hand: place a photo by clicked points, and check a map against control points."""
