"""What is kept on this machine: run folders, campaigns, the model in use of each vehicle and those before it."""
