"""What was found as what is shown: views and documents. Must not compute, read or write."""
