"""Published studies as folders of files: what they printed, the commands, printed against ours."""
