"""The ground floor: errors, arrays, time, geodesy, files, console, variance; stands on nothing of ours."""
