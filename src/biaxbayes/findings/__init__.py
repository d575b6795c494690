"""What the posterior says: identifiability, profiles, bands, comparisons, designs."""
