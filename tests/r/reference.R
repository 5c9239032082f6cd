# Compare the statistics of an analysis with R's own, from the same answers.csv. In its folder: Rscript reference.R
# Each line gives how many numbers were compared and the largest difference; a difference above its limit is fatal.
answers <- read.csv("answers.csv", stringsAsFactors = TRUE)
tests <- read.csv("tests.csv")
if ("part" %in% names(tests)) quit() # in a design that is not crossed each part has separate tests
measures <- if (file.exists("measures.csv")) read.csv("measures.csv") else NULL
alike <- TRUE

compare <- function(what, ours, reference, limit) {
  far <- max(abs(ours - reference))
  cat(sprintf("%-58s %4d numbers, largest difference %.2g\n", what, length(ours), far))
  if (!is.finite(far) || far > limit) alike <<- FALSE
}

rows_of <- function(name) tests[grepl(name, tests$name, fixed = TRUE) & !is.na(tests$p), ]
scope_of <- function(table) paste(table$finger_condition, table$pair)

# Cells against chance, and the proportion that chose the dominant zone: outcomes enumerated, and binom.test.
cells <- rows_of("exact multinomial test of all answers against chance")
if (nrow(cells) && "zone" %in% names(answers)) {
  likelihood <- function(k) 2 * sum(ifelse(k > 0, k * log(k * length(k) / sum(k)), 0))
  exact <- function(k) {
    all <- expand.grid(rep(list(0:sum(k)), length(k)))
    all <- as.matrix(all[rowSums(all) == sum(k), ])
    sum(apply(all, 1, dmultinom, prob = rep(1, length(k)))[apply(all, 1, likelihood) >= likelihood(k) - 1e-9])
  }
  zone <- factor(answers$zone, c("dominant", "other", if (any(grepl("both", cells$note))) "both"))
  counts <- table(paste0(scope_of(answers), " ", format(answers$velocity_mm_s, trim = TRUE), " mm/s"), zone)
  counts <- counts[cells$scope, , drop = FALSE]
  once <- rowSums(counts) == nlevels(answers$participant)
  if (any(once)) compare("exact multinomial test: p", cells$p[once], apply(counts[once, , drop = FALSE], 1, exact), 1e-9)
  bounds <- sapply(which(once), function(i) binom.test(counts[i, "dominant"], sum(counts[i, ]))$conf.int)
  shares <- tests[tests$name == "share in a cell, exact interval", ]
  shares <- shares[match(cells$scope[once], shares$scope), ]
  if (any(once)) compare("Clopper and Pearson, binom.test: bounds", rbind(shares$low, shares$high), bounds, 1e-9)
}

# Net dominance by sign flips, and conditions on average: the permutation test of exactRankTests.
flips <- rows_of("exact sign-flip test of net dominance")
if (nrow(flips) && "zone" %in% names(answers) && requireNamespace("exactRankTests", quietly = TRUE)) {
  score <- tapply((answers$zone == "dominant") - (answers$zone == "other"), list(answers$participant, scope_of(answers)), sum)
  p <- apply(score[, flips$scope, drop = FALSE], 2, function(own) exactRankTests::perm.test(as.integer(own), exact = TRUE)$p.value)
  compare("sign flips, perm.test: p", flips$p, p, 1e-9)
}

# A trend over levels: the conditional test of coin within participants, whose p is simulated.
trends <- rows_of("exact trend test")
if (nrow(trends) && "zone" %in% names(answers) && length(unique(answers$velocity_mm_s)) > 1 && requireNamespace("coin", quietly = TRUE)) {
  set.seed(1)
  p <- sapply(trends$scope, function(scope) {
    own <- answers[scope_of(answers) == scope, ]
    own <- droplevels(own[ave(own$dominant, own$participant, FUN = function(each) length(unique(each))) > 1, ])
    if (!nrow(own)) return(1)
    coin::pvalue(coin::independence_test(
      dominant ~ velocity_mm_s | participant, data = own, distribution = coin::approximate(nresample = 20000)
    ))
  })
  compare("trend within participants, independence_test: p (drawn)", trends$p, p, 0.02)
}

# Friedman's statistic and Kendall's W, and p from permutations by coin.
for (i in which(grepl("Friedman", tests$name))) {
  name <- sub(" over levels.*", "", tests$name[i])
  own <- measures[measures$measure == name & scope_of(measures) == tests$scope[i], ]
  table <- tapply(own$estimate, list(own$participant, own$velocity_mm_s), mean)
  table <- round(table[rowSums(is.na(table)) == 0, ], 9)
  found <- friedman.test(table)
  compare(paste("friedman.test of", name), tests$statistic[i], found$statistic, 1e-6)
  compare(paste("Kendall's W of", name), tests$estimate[i], found$statistic / (nrow(table) * (ncol(table) - 1)), 1e-9)
  if (requireNamespace("coin", quietly = TRUE)) {
    set.seed(1)
    long <- data.frame(y = c(table), who = factor(row(table)), level = factor(col(table)))
    drawn <- coin::friedman_test(y ~ level | who, data = long, distribution = coin::approximate(nresample = 20000))
    compare(paste("friedman_test of", name, "by shuffles: p (drawn)"), tests$p[i], coin::pvalue(drawn), 0.02)
  }
}

# Signed ranks between conditions: mean over levels of each participant's differences.
for (i in which(grepl("signed ranks", tests$name) & !is.na(tests$p))) {
  name <- sub(" compared.*", "", tests$name[i])
  own <- measures[measures$measure == name, ]
  pair <- strsplit(sub(" [^ ]+$", "", tests$scope[i]), " - ", fixed = TRUE)[[1]]
  if (length(pair) != 2 || !all(pair %in% own$finger_condition)) next
  own <- own[own$pair == sub(".* ", "", tests$scope[i]), ]
  values <- tapply(if (all(own$estimate > 0) && grepl("geometric", own$quantity[1])) log(own$estimate) else own$estimate,
                   list(own$participant, own$velocity_mm_s, own$finger_condition), mean)
  gap <- round(rowMeans(values[, , pair[1]] - values[, , pair[2]], na.rm = TRUE), 9)
  if (requireNamespace("exactRankTests", quietly = TRUE)) {
    found <- suppressWarnings(exactRankTests::wilcox.exact(gap, exact = TRUE))
    compare(paste("signed ranks, wilcox.exact, of", name), tests$p[i], found$p.value, 1e-9)
  }
}

# Exponents of magnitudes: lm and confint.
own <- measures[grepl("^exponent of", measures$measure), ]
if (!is.null(measures) && nrow(own)) {
  fits <- lapply(seq_len(nrow(own)), function(i) {
    given <- answers[answers$participant == own$participant[i] & scope_of(answers) == scope_of(own)[i], ]
    lm(log(value) ~ log(velocity_mm_s), data = given[given$value > 0, ])
  })
  compare("exponents, lm", own$estimate, sapply(fits, function(fit) coef(fit)[2]), 1e-9)
  compare("their intervals, confint", rbind(own$low, own$high), sapply(fits, function(fit) confint(fit)[2, ]), 1e-9)
}

# d' of two intervals by level: (z(H) - z(F)) / sqrt(2) of rates (k + 0.5) / (n + 1).
own <- measures[measures$measure == "d'" & measures$note == "2AFC model" & measures$velocity_mm_s != "all", ]
if (!is.null(measures) && nrow(own) && all(c("interval", "chosen") %in% names(answers))) {
  rate <- function(given) (sum(given) + 0.5) / (length(given) + 1)
  by_hand <- sapply(seq_len(nrow(own)), function(i) {
    cell <- answers[answers$participant == own$participant[i] & scope_of(answers) == scope_of(own)[i] &
                      answers$velocity_mm_s == as.numeric(own$velocity_mm_s[i]), ]
    named <- ifelse(cell$chosen == 1, cell$interval, 3 - cell$interval)
    abs(qnorm(rate(named[cell$interval == 1] == 1)) - qnorm(rate(named[cell$interval == 2] == 1))) / sqrt(2)
  })
  compare("d' of two intervals, by hand: size", abs(own$estimate), by_hand, 1e-9)
}
if (!alike) quit(status = 1)
