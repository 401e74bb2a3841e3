"""The tuner learns the running process: experiments on it, handing over new gains, adapting."""
