"""Output for people: reports, tables, figures, lines on a terminal."""
