"""From records to tables, statistics, figures and the report; needs neither instrument nor screen."""
