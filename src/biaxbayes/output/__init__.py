"""What the user gets back: run folders, tables, figures, reports, material cards."""
