"""Stand-ins with the method names of other packages."""
