"""The plants of the thesis's examples, with the laws and settings they are learned by."""
