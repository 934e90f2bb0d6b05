"""A run over driver messages: the cell and the controller in processes of their own."""
