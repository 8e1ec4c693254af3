"""Settings: what they are, how they are read, and the quantities in their texts."""
