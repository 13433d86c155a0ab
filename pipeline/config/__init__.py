"""What a user may write: experiments, studies, and the messages about them."""
