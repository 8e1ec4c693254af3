"""What a person reads: reports, tables, figures, lines on a terminal."""
