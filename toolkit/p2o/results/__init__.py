"""What comes out, and how it is written down."""
