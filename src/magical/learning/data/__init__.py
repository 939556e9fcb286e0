"""What is learned from: demonstrations and labelled episodes as samples, and batches of them."""
