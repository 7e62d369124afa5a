"""Pickles of one small table, written by pandas itself: x, y, z, i, t as numbers, d as whole numbers; three points."""

from __future__ import annotations

import base64
import lzma

_LABELS = (
    "1.0.5, protocol 2",
    "1.0.5, protocol 4",
    "1.2.5, protocol 5",
    "1.5.3, the points with d = 0",
    "2.2.3, protocol 5",
    "3.1.1, protocol 5",
)
_PACKED = (
    "T>t<81poj4|NsC0{{TP$hy%+I><oJQ&j`o|pWnEda{i(51q;UdbNW=L7@uIMd~^^3InM`=L~Z=!wc@AYSE*qqZfmA|BRa+frE6JT>sE1^U9MM$2P"
    "d$TALM??!&*TE`RKJG9SKH(ntJU4U&F#?hfWAU-#7Sbf}cnlK<6=rL$=`{qsf{7gwq-BcXd;@d0)aTMNE@z7t8|T=azG4(=P3lZfhKpGiE9d&jnb"
    "w)ZFUscKbj{a%hk1-u}!2`C=nwHEHBmgQRD8Dle`_s1$lwFDInp@N5nd?+{37XO;HtVUxMDmiEPdl;3B&@o$M+TydrOoJlL7bg}1HpWYt=y?F(|F"
    "ui4O3Q^rVkG!sq>Dmz3kCF&&>~tyBu}?azi{nql(s5t0=o<$Kqwt?b@1e>*9HIds9ID!wfc}4`Zq@Uf)d`Z5mhQ>D(|C-!8t*QLfH_Im1iL|r>%k"
    "uS3KT&!jK*XK-y+$GQC2T3@xN%{*EFL^T)U*zYWYDS0p+Nw&Z4>l9+f%@(n0iz8GgpVW~0Uu%In&3CNk`^V2@d&yxH$D*`?QTZ8sh`lmFDC!&qGY"
    "y=Wp47*gT~V__54NYWYB;joR9;C6i>jL{8_fsUqA?v27aa?#doKd8HKKtPr*F=1$MoBRa%5FW#noj4(0%74-ouHT2z$2yc)tB8lm^nZ`fH~ZlZL1"
    "@B^pPx4HM+Gk!>%TQPq<r&~r&sCd{<&RXvs~*D8S_mzG5f>$j!#n*sgE%zD>rW#!uXb)Bmj#10DhMEJximc{vDta$q5som6E#<L=e-LOT2hpVQ_s"
    "6LbUcOv$<FDlz;6hCC5&IBN_jtUE}0e>z%WwHb*uxZ{>nx&vSpo7K4G=hJD}(_gwD$R@XkyZU9qRhd{@*wwx3(`-gb=<=4qJtO#MK3v4FlM9hd!t"
    "ruS2QeSo4jYH#7z{BKQnH;D5-wzz3Z83for_hTvVI^Q9%5f?~9}-heqXxS%wRWvP+K!Ze&c-k-RCO+VyI#vB^-ayhQ-)GpU^r-GZ8kLawuPnV5FI"
    "b*oYf}_jaSz;pGQ(ZU<f!sUna?1W7$zq4*~}|XziZee8lvqd?i$Ge*}><bAgR|Ini8xhf02UcK|kz)=<F@6IQOm_-IruP1&FT^MvUGOksW&e&O7G"
    ";FEcW7u}EVsU7PYb}&4O(Pps4G|V4RW3+=pV~UB3t8ZKvIs=4G#7#4O`M#BC9Kua;cXpECcR}+_LLVl53{p)5To3+Qjm*VPTz7PU3j6Mcrd9sI5)"
    "wMt=fxyDaf%&i)#RjdAY(K&j6y$R$tK==9FFEIq%MIh_R;B4UI`4vwJA`)JfL{$^LtO3@51zs_8l25v)ws^;CFz$)C?oSgP!7Ib9se|!ysPA7^cn"
    "PhAH!+sG7Mg6>dQWl01sH1lu7>6JRS!!6e}5|CwlQzudLObmuRNV#-@`W~uc{p;agj;>N#_5F&Cf3A$@ug*a)XlySej9@Zeh0?)Uvovjp;F&(u1G"
    "$T|=h>m(%@634<{f@`?9N$ME4v)06Q52@odwA@e<L}^$qu{i69cdZ(0|Y)E&_-bJMkuqNA_1ySRJ0$SlDMamc0I0TW|1M;cGjJ44fWQ9it7oQQ{="
    "hrFuJS+Unf_4z@mrfr)iVbzdv^SNd-ihyhn^BD!R$O`3W3ICdzEy!RuMTq~_HSR)VhB_dK-Q+Sj%pX9ARB-hH7mPQLrx2mt=^*97&7l>?4%S$*)c"
    "R{$g_4eYl;G`v5}$Pi}nBCWW_v-QQ><oSoDz1M@b-h2m<A7JK3VNt*g-gkVk%S(`YU(;U<AUmj<W-|QZg~ukcm=3KfqMQHsZ5lN&Qxk)$ir#@Sbq"
    "+6q`Lho^Zk8dCrMbkQ#8hoaVyMmI45E3y50c7aLq~A&*p+BM7~2#F3Jcb1l2s3_qGhcS_04!5=U0Lw5tZseYj02l|4swl+rrd#5h@1)tzrIbe-yY"
    "Bzb+kcLoJYv{VRyk)6?yP50M60O!YCTKDUHY?idUl-y?rQGoQhS)y_}zjUZ?>6}@L-u>x85zYQpsTo`_CL?a(i$8G3-o=UEF|L5ES!v"
)
PICKLES = dict(zip(_LABELS, lzma.decompress(base64.b85decode(_PACKED)).split(b"--next--"), strict=True))
X = [1.5, 2.5, -3.0]
T = [1557539924.5, 1557539924.6, 1557539924.7]
D = [0, 1, 0]
