"""The fleet's own authority, what each host's door lets in, and who has been turned out."""
