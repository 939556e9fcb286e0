"""Training data: demonstrations and labelled episodes as samples, and batches of them."""
