"""File formats of other ground stations, read and written by pure functions that name the file and the line at fault."""
