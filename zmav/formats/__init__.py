"""File formats of other ground stations: pure functions, whose errors name the file and the line at fault."""
