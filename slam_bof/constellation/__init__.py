"""BOF contours of levelled slices with their places: what finds a view again, and from where."""
