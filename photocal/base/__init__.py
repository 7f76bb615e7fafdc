"""The ground floor: errors, arrays, time scales, geodesy, files, console; stands on nothing of ours."""
