"""The ground floor: errors, arrays, time scales, geodesy, files, console, tests of variance; stands on nothing of ours."""
