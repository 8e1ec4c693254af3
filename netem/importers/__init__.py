"""Foreign measurements of a link as delay profiles; `docs/importers.md` lists the formats."""
