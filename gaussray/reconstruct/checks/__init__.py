"""What is wrong with the pictures or the poses of a capture, or with a fit of them."""
