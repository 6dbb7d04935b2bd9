"""Videos whose pictures hold several views or maps side by side, and the commands that cut them."""
