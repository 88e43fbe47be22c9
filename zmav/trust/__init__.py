"""Who is who: certificates of the fleet's own authority, proofs of origin, and what each role may do."""
