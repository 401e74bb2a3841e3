"""The live page: the loop's signals as they come, gains to slide, tuning and taking it back."""
