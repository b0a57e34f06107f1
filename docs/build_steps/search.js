// Ranks what the search finds: how-tos before other pages, names and commands last.
var Scorer = {
  score: ([page, , , , score]) => score + (/^(how_to\/|accuracy$)/.test(page) ? 5 : page.startsWith("reference/") ? -200 : 0),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
