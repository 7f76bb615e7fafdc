"""One window from the folder to the signed certificate: a local page over the steps that commands take."""
