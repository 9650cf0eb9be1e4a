"""What may happen to a message on its way: ordered rules, and the profiles made of them."""
