"""How the rows are shown; nothing that is measured depends on it."""
