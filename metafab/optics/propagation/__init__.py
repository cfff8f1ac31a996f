"""From block sums over the pupil to irradiance on a window of the sensor."""
