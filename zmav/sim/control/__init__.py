"""The controller cascade, vectorised: position -> velocity -> attitude -> rate -> rotors."""
