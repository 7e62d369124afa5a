"""How a method becomes a result: Algorithm 1, the judge, adjustment, agreement, verdict."""
