"""Identification of the vehicle from one noisy IMU (section 6.3), from excitation to a reduced model with
intervals.

    excitation -> frf -> one of three builders (channel_wls, vector_fitting, maximum_likelihood) -> reduction
                      -> physical (thirteen parameters)

Every step works on `FrfData`: frequency responses of all input-output paths with their variances.
"""
