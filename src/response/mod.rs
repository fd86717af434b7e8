//! Response: from code values to exposure.
