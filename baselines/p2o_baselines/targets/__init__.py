"""Methods with boards, balls and boxes of known size."""
